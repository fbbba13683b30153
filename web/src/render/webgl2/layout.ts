/** Quads of one instance: batches are several times faster than one quad an instance. */
export const kBatch = 128;
/** Rows that lie side by side in the textures of rows. */
export const kRowsWide = 2048;
export const kOrderWidth = 2048;
