"""From photographs of a printed board to pixels, and to where camera and board are."""
