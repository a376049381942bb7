"""Rails of three axes behind the controller ACME: an example of a driver outside the package hil."""
