"""The tasks (one folder and one record each), and the worlds in which robots do them."""
