"""What a run means: verdict against the requirements, key numbers, summaries."""
