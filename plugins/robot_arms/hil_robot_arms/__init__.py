"""What the drivers of six-joint robots share: kinematic model, cycles on UDP, mechanics of emulated robots."""
