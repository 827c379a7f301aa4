// Starts what a page needs. Each module looks for its own elements and does nothing without them.
import { startLive } from './live.js';
import { startActions } from './actions.js';
import { startUpload } from './upload.js';
import { startViewer } from './viewer.js';
import { startLog } from './log.js';
import { startForm } from './form.js';
import { startCharts } from './charts.js';
import { startCompare } from './compare.js';
import { startKeys } from './keys.js';
import { hideMissingImages } from './images.js';

// On a narrow screen the page's own name may lie outside of the row of pages. Not by scrollIntoView: the Tab key would then
// begin there.
const here = document.querySelector('header nav [aria-current]');
if (here) {
  const row = here.closest('nav');
  const [inner, outer] = [here.getBoundingClientRect(), row.getBoundingClientRect()];
  row.scrollLeft += inner.left + inner.width / 2 - outer.left - outer.width / 2;
}
hideMissingImages();
startKeys();
startLive();
startActions();
startUpload();
startViewer();
startLog();
startForm();
startCharts();
startCompare();
