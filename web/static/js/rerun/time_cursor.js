// The message that moves Rerun's time cursor to a moment and pauses it: a ViewerControlRequest of Rerun's Viewer
// Control API (rerun/v1alpha1/viewer_control.proto of 0.41), as `rerun.experimental.ViewerClient.set_time` sends it:
// field 6, set_time_cursor, with timeline (2: its name 1), time (3: nanoseconds 1) and play_state (5: paused 1).

const PAUSED = 1;

export function moment(timeline, seconds) {
  const name = [...new TextEncoder().encode(timeline)];
  const time_ns = BigInt(Math.round(seconds * 1e9));
  const cursor = [...part(2, part(1, name)), ...part(3, number(1, time_ns)), ...number(5, BigInt(PAUSED))];
  return Uint8Array.from(part(6, cursor));
}

/** A field that holds bytes: https://protobuf.dev/programming-guides/encoding/. */
function part(field, bytes) {
  return [...varint(BigInt((field << 3) | 2)), ...varint(BigInt(bytes.length)), ...bytes];
}

/** A field that holds a number. */
function number(field, value) {
  return [...varint(BigInt(field << 3)), ...varint(BigInt.asUintN(64, value))];
}

function varint(value) {
  const bytes = [];
  for (; value > 127n; value >>= 7n) bytes.push(Number(value & 127n) | 128);
  return [...bytes, Number(value)];
}
