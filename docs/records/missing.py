"""What is raised where a page needs a record that there is not."""


class Missing(KeyError):  # noqa: N818 - it says what a record is, and is not a fault
    """A record that has not been measured."""
