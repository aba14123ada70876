// What Rerun's viewer may fetch: what this page's server has for it. The rest is its fonts, its news and its telemetry,
// which the Content-Security-Policy would refuse, too, but with an error in the console for each.

const fetchAnything = globalThis.fetch.bind(globalThis);

/** A `fetch` that asks this server: `addresses` has its own address for each path that the viewer asks for. */
export function fetchHere(addresses) {
  return async (asked, options) => {
    const request = new Request(asked, options);
    const { origin, pathname } = new URL(request.url);
    if (addresses[pathname]) {
      const { method, headers, signal } = request;
      return fetchAnything(addresses[pathname], { method, headers, signal, body: await request.arrayBuffer() });
    }
    return origin === location.origin ? fetchAnything(request) : new Response(null, { status: 204 });
  };
}
