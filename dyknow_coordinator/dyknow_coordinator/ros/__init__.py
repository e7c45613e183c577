"""The node that answers whether formulas hold."""
