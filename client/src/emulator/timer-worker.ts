/** A worker that calls so many times a second: neither drawing nor a page in the background slows its clock. */

const RATE_HZ = 90;

setInterval(() => postMessage(null), 1000 / RATE_HZ);
