"""Motion of articulated objects and rendered scenes."""
