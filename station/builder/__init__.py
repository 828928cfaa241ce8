"""The tree builder: a drawn tree as a value, pure edits of it, and what a page shows; the page itself is `page`."""
