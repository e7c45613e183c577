"""What follows from verdicts: black boxes, triggers and guards."""
