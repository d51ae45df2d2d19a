"""How the bodies in ``src/avrgym/assets/human`` were made; see ``make_human_mesh.py``."""
