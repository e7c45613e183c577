"""The eight relations between regions (RCC-8), drawn or told."""
