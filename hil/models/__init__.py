"""Models of bench components: servo, valves, cameras, mounting, motion profiles."""
