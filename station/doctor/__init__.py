"""What keeps a rig from being used, and how to mend it: checks of port, bus, camera and disk."""
