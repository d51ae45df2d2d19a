/** A timer in a worker, whose rate depends neither on drawing nor on the page's visibility. */

const RATE_HZ = 90;

setInterval(() => postMessage(null), 1000 / RATE_HZ);
