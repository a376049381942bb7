"""Rails of three axes behind an ACME controller: an example of a driver outside the package hil."""
