"""What a tool with an edge really cuts: programs, their axes in time, the virtual part, its errors.

programs: a program and what joins its blocks; motion: what the axes must do; virtual_part: the
surface that a program leaves; edge_errors: an edge that is not the programmed one, cusps.
"""
