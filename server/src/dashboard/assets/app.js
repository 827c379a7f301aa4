// Starts what a page needs. Each module looks for its own elements and does nothing without them.
import { startLive } from './live.js';
import { startActions } from './actions.js';
import { startUpload } from './upload.js';
import { startViewer } from './viewer.js';
import { startLog } from './log.js';
import { startForm } from './form.js';
import { startCharts } from './charts.js';
import { startCompare } from './compare.js';
import { hideMissingImages } from './images.js';

hideMissingImages();
startLive();
startActions();
startUpload();
startViewer();
startLog();
startForm();
startCharts();
startCompare();
