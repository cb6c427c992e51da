"""Maps: three flats, rotations, shifts, balls, registration and stitching."""
