/** What web/wasm/api.h exports; pointers and handles are offsets in `memory`. */
export interface Exports {
  readonly memory: WebAssembly.Memory;
  alloc(bytes: number): number;
  release(memory: number): void;
  follower_new(name: number, nameBytes: number, maxGaussians: number, nowMs: number): number;
  follower_delete(session: number): void;
  follower_restart(session: number): void;
  receive(session: number, message: number, bytes: number, nowMs: number): number;
  error_text(session: number): number;
  error_bytes(session: number): number;
  next_outgoing(session: number, nowMs: number): number;
  outgoing_ptr(session: number): number;
  farewell(session: number): number;
  set_max_kbps(session: number, kbps: number): void;
  player_index(session: number): number;
  set_pose(session: number, pose: number): number;
  ask_picture(session: number, probeId: number, pose: number): number;
  take_picture(session: number): number;
  picture_info_ptr(session: number): number;
  picture_ptr(session: number): number;
  picture_transforms_ptr(session: number): number;
  take_changes(session: number, maxRows: number): number;
  changed_rows_ptr(session: number): number;
  changed_records_ptr(session: number): number;
  changed_origins_ptr(session: number): number;
  changed_left_ptr(session: number): number;
  harmonic_words(session: number): number;
  changed_harmonics_ptr(session: number): number;
  take_colors(session: number, maxRows: number): number;
  changed_colors_ptr(session: number): number;
  forget_taken(session: number): void;
  row_capacity(session: number): number;
  transforms_ptr(session: number): number;
  transform_count(session: number): number;
  far_field_index(session: number): number;
  background_ptr(session: number): number;
  scene_version(session: number): number;
  stats_ptr(session: number): number;
  held_hash_ptr(session: number): number;
  sorter_new(): number;
  sorter_delete(sorter: number): void;
  sorter_rows(sorter: number, rows: number): void;
  sorter_update(sorter: number, rows: number, records: number, n: number): number;
  sorter_transforms(sorter: number, transforms: number, n: number, farField: number): void;
  sort(sorter: number, viewFromWorld: number): number;
  order_ptr(sorter: number): number;
}

/** `onGrowth` is called when the memory has grown: views on it are dead. */
export function instantiate(
  source: WebAssembly.Module | BufferSource | Response | Promise<Response>,
  onGrowth?: () => void,
): Promise<Exports>;
