"""Reads, audits and fits the rig's pressure logs, and finds effects that the model lacks. This
package may import `discrepancy` and packages of lower layers."""
