"""Force sensors: ATI Net F/T over UDP, and gauge voltages of an NI card. May import `recording` and
`protocol`."""
