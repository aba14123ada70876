// The fetches of Rerun's viewer: only those that this page's server answers. The rest is its fonts, its news and its
// telemetry, which the Content-Security-Policy would refuse, too, but with an error in the console for each.

const fetchAnything = globalThis.fetch.bind(globalThis);

/** A `fetch` from this server: `addresses` has its address for each path that the viewer fetches. */
export function fetchHere(addresses) {
  return async (resource, options) => {
    const request = new Request(resource, options);
    const { origin, pathname } = new URL(request.url);
    if (addresses[pathname]) {
      const { method, headers, signal } = request;
      return fetchAnything(addresses[pathname], { method, headers, signal, body: await request.arrayBuffer() });
    }
    return origin === location.origin ? fetchAnything(request) : new Response(null, { status: 204 });
  };
}
