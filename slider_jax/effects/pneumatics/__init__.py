"""Effects of valves, flow and chambers; may import `effects` and the rooms below it."""
