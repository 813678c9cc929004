"""Simulates one robot in real time from set pressures to readings, with faults. This package may
import `simulation` and packages of lower layers."""
