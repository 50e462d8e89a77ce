"""Checkers of the workbook's exercises, one file a chapter.

They can be read, and that is said to students: what they hold against answers is no secret.
"""
