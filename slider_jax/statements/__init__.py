"""Checks the paper's statements by simulation, and searches assumptions with which they agree.

Imports from `optimise`, `reproduction` and the rooms below them.
"""
