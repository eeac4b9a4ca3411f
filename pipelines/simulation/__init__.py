"""What `quadlog simulate` is made of: where to walk, by what robot and controller, and the folder of one walk."""
