"""Reads, audits and fits the rig's pressure logs, and closes the loop on them. May import
`discrepancy` and the rooms below it."""
