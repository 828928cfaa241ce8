"""Videos of marked objects that anything moves: their frames with stamps, what is seen in them, and a session of it."""
