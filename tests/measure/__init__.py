"""The programs behind the README's figures. Each prints a table; none of them decides whether a test passes."""
