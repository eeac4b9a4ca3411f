"""One batch over knots and global unknowns: the estimator of positions, biases, headings of bodies, and anchors."""
