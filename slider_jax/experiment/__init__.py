"""Reads experiment files and prepares their trials: models, played drives and measured data. This
package may import `paper`, `channels` and packages of lower layers."""
