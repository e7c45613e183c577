"""Black boxes: bags that know the formula that failed."""
