"""The console: one web page to see and command a session at the bench, served by a process of its own."""
