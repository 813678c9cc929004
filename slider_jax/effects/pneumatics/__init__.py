"""Effects of valves, flow and chambers. This package may import `effects` and packages of lower
layers."""
