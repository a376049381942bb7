"""Models of bench components: servo, cameras, mounting, motion profiles."""
