"""What experts share: leading a tool through space, and the room that arms have."""
