"""Guards: messages pass while formulas hold."""
