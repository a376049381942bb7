"""Rails: three linear axes, each a servo drive on Modbus TCP."""
