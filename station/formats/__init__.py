"""Importers and exporters of the files that others use."""
