"""What calibrations need of cameras, arms and files: views of a board, swings, reference poses, known lengths."""
