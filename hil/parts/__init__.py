"""Parts: capabilities of a bench in addition to its core, each a folder; ``declarations`` lists them."""
