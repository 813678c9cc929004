"""Effects of valves, flow and chambers. This package may import `effects` and lower layers."""
