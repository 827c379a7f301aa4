// What the service expects a job to take, beside the form.

export function showEstimate(estimate) {
  const place = document.getElementById('estimate');
  place.hidden = false;
  const parts = [
    ['scene', estimate.scene_bytes],
    ['Line Spaces at most', estimate.line_space_bytes ?? NaN],
    ['picture', estimate.picture_bytes],
  ];
  const known = parts.filter(([, bytes]) => bytes > 0).map(([name, bytes]) => `${name} ${sizeOf(bytes)}`);
  const unknown = estimate.line_space_bytes === null ? '; what its Line Spaces take, only building tells' : '';
  place.querySelector('[data-memory]').textContent = `about ${sizeOf(estimate.bytes)}: ${known.join(', ')}${unknown}`;
  place.querySelector('[data-time]').textContent = timeOf(estimate);
}

export function hideEstimate() {
  document.getElementById('estimate').hidden = true;
}

function timeOf({ render_s, measured }) {
  if (!measured) return 'no measurement yet';
  const { jobs, same_scene, device, mrays_per_s } = measured;
  const like = `${jobs} ${jobs === 1 ? 'job' : 'jobs'} ${same_scene ? 'of this scene' : 'of other scenes'}`;
  return `about ${durationOf(render_s)}, by ${like} on ${device} at ${mrays_per_s.toPrecision(3)} MRays/s`;
}

function sizeOf(bytes) {
  const units = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  const power = Math.min(Math.max(Math.floor(Math.log2(bytes) / 10), 0), units.length - 1);
  const value = bytes / 1024 ** power;
  return `${value.toFixed(power > 0 && value < 99.95 ? 1 : 0)} ${units[power]}`;
}

function durationOf(seconds) {
  if (seconds < 1) return `${Math.ceil(seconds * 1000)} ms`;
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const minutes = Math.round(seconds / 60);
  return minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}
