"""Predicts the markers of a soft arm with two tendons from the tensions, and finds the effects that
the model of the arm lacks. This package may import `discrepancy` and packages of lower layers."""
