"""Handlers of the URLs of pyserial, ``SCHEME://PATH``, that open a serial port in another way."""
