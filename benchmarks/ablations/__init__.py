"""What each part of the method is worth: the same pairs, with one thing changed."""
