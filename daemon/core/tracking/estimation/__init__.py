"""Estimation of the object in one step: measurements, predictions and corrections."""
