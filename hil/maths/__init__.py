"""Functions of numbers: floats and arrays in, floats and arrays out."""
