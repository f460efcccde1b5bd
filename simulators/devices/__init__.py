"""The plants on real transports: pure devices, each with a thin shell around it."""
