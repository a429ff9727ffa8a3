"""What Sphinx needs beside its own: reference pages from the code, pictures and formulas without a network."""
