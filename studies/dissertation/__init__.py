"""Studies of the dissertation (Karkee 2009), done again: each gives one part of a page in docs/."""
