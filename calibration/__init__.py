"""Calibration of a skin by itself: offsets, drift, gains and defects, from sums alone; arrays in, arrays out."""
