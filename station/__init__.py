"""Capture-and-fit station: watch a marked mechanism move, discover its joints, compare them with the commands."""
