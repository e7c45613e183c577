"""Black boxes: the messages around the moment when a formula failed, as bags."""
