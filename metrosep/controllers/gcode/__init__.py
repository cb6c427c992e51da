"""Corrections carried by the tool path itself: NC programs and lists of points, rewritten.

state: words of a block and modal codes; corrections: what is added where; columns and rewrite:
an NC program in pieces; paths: the whole program; lists: points in columns.
"""
