"""Images, contacts and labels of a robot skin, for programs."""
