// Odd stretches: their groups, and going from one to the next.

/** Stretches that touch or overlap, as one group with all their flags. */
export function grouped(stretches) {
  const groups = [];
  for (const [flag, first, last, cause] of stretches) {
    const before = groups.at(-1);
    if (before && first <= before.last + 1) {
      before.last = Math.max(before.last, last);
      before.flags.add(flag);
      if (cause) before.causes.push(cause);
    } else {
      groups.push({ first, last, flags: new Set([flag]), causes: cause ? [cause] : [] });
    }
  }
  return groups;
}

/** The groups with a row that has none of these tags. */
export function left(groups, tags, names = ["exclude", "fine"]) {
  const done = tags.filter((tag) => names.includes(tag.name));
  let next = 0; // the first tag that does not end before the group
  return groups.filter(({ first, last }) => {
    while (next < done.length && done[next].last < first) next += 1;
    let reached = first;
    for (let at = next; at < done.length && done[at].first <= reached; at += 1) {
      reached = Math.max(reached, done[at].last + 1);
    }
    return reached <= last;
  });
}

/** Goes through lists of stretches, one list after the other. The first list follows the last one. */
export class Round {
  #at = 0; // the list

  /** The next stretch after a position, or the one before it (`step` -1); null if all lists are empty. */
  next(lists, position, step) {
    const filled = lists.filter((list) => list.length);
    if (!filled.length) return null;
    this.#at = Math.min(this.#at, filled.length - 1);
    for (let tried = 0; tried <= filled.length; tried += 1) {
      const list = filled[this.#at];
      const next = step > 0 ? list.find(({ first }) => first > position) : list.findLast(({ last }) => last < position);
      if (next) return next;
      this.#at = (this.#at + step + filled.length) % filled.length;
      position = step > 0 ? -1 : Infinity;
    }
    return null;
  }
}

export function words(group) {
  return [...group.flags].map((flag) => flag.replaceAll("_", " ")).join(", ");
}
