"""Effects of valves, flow and chambers. They may import `effects` and lower layers."""
