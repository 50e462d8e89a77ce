"""Grading: exercises that answer back, and the copies that are handed out."""
