"""What the camera will see of a planned motion: which markers when, how obliquely, how smeared, and why not."""
