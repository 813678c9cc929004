"""Drivers of force sensors: an ATI Net F/T box over UDP, and strain gauges on an NI card. This
package may import `recording` and `protocol`."""
