"""The paper's data management subsystem (DMS): every cycle, frame and event of a run in one MCAP file."""
