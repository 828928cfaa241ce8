"""Frames to marker observations and poses."""
