"""What a machine can feel twice: kinds of measurement, joint terms and origins of trades whose instrument is itself."""
