"""The capture service: commands an arm, or looks on while people move it, and records what the camera sees."""
