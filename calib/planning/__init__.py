"""What poses determine, which of them to measure, and what to measure next."""
