"""Folders that are not what was asked for, and folders that are."""
