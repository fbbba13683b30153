/** Rows that lie side by side in the textures of rows. */
export const kRowsWide = 2048;
export const kOrderWidth = 2048;
