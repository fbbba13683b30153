/**
 * What is drawn of a splat: of the triangle about the unit circle, (-kHalfBase, -1), (0, 2), (kHalfBase, -1), as much as its
 * alpha reaches. Its area is 1.3 times that of the square about the same circle, but it is one primitive of three corners; a square
 * is two of four, and pixels on its diagonal are shaded twice.
 */
export const kHalfBase = Math.sqrt(3);
