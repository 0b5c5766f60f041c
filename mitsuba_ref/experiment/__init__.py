"""What `stress` and `bench` have in common: selection, exact answers, result files and tables."""
