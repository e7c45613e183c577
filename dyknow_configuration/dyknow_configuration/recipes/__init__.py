"""Recipes: formulas that many robots must keep, and their copies in a robot.yaml."""
