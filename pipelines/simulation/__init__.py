"""`quadlog simulate` and `synthesize`: where to walk, by what robot and controller, and the folder of one walk."""
