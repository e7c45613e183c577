"""Calibration of forecasts by what came true in recordings."""
