"""The robots: one folder and one record each; ``registry`` knows them and those of other packages."""
