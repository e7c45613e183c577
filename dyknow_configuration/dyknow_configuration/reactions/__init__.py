"""What follows from verdicts, as a robot.yaml describes it."""
