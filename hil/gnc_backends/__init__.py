"""GNC backends: everything that can close the loop, behind one Protocol."""
