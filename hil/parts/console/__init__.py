"""Console: web page that shows and commands a session at the bench, served by a separate process."""
