"""Check of an external GNC: plays known inputs to it and reports errors of its replies."""
