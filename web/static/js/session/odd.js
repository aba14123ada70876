// Odd stretches to go through: those that touch or overlap are one, with all its flags.

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

/** Those with a row that has no tag of these names. */
export function left(groups, tags, names = ["exclude", "fine"]) {
  const done = tags.filter((tag) => names.includes(tag.name));
  let at = 0;
  const found = [];
  for (const group of groups) {
    while (at < done.length && done[at].last < group.first) at += 1;
    let reached = group.first;
    for (let each = at; each < done.length && done[each].first <= reached; each += 1) {
      reached = Math.max(reached, done[each].last + 1);
    }
    if (reached <= group.last) found.push(group);
  }
  return found;
}

/** Goes through lists of stretches, one list after the other; behind the last list comes the first one again. */
export class Round {
  #at = 0; // the list

  /** The next one behind a position, or the one before it (`step` -1); null where all lists are empty. */
  next(lists, position, step) {
    const filled = lists.filter((list) => list.length);
    if (!filled.length) return null;
    this.#at = Math.min(this.#at, filled.length - 1);
    for (let tried = 0; tried <= filled.length; tried += 1) {
      const list = filled[this.#at];
      const found = step > 0 ? list.find((each) => each.first > position) : list.findLast((each) => each.last < position);
      if (found) return found;
      this.#at = (this.#at + step + filled.length) % filled.length;
      position = step > 0 ? -1 : Infinity;
    }
    return null;
  }
}

export function words(group) {
  return [...group.flags].map((flag) => flag.replaceAll("_", " ")).join(", ");
}
