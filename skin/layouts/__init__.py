"""Layouts that ship with the project."""
