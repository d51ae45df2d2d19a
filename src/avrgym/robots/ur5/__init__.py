"""Universal Robots' UR5: six joints, on a stand."""
