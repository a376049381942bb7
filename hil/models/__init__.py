"""Models of bench components: servo, valves, camera timing, plumes, motion profiles."""
