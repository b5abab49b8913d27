"""The past as hypotheses of Bernoulli targets tell it, one target and one parent at a time."""


def told(layers, ended, least):
    """What each frame before the last is told as: {label: (hypothesis, presence)}, newest first, as far as it has changed.

    ``layers``, oldest first: dictionaries of ``label``, ``best``, ``presence``, ``believed`` by target, of ``target`` and
    ``parent`` by hypothesis. ``ended``: pairs (frames back, hypothesis).
    """
    own = [
        {label: (c, r) for label, c, r in zip(x["label"], x["best"], x["presence"], strict=True) if c >= 0} for x in layers
    ]
    now, known, out = own[-1], own[-2] if len(layers) > 1 else None, []
    for back in range(1, len(layers)):
        now = _earlier(now, layers[-back], layers[-back - 1], [c for b, c in ended if b == back])
        if back > 1:
            known = _earlier(known, layers[-back], layers[-back - 1], [c for b, c in ended if b == back])
        if _tellable(now, layers[-back - 1], least) == _tellable(known, layers[-back - 1], least):
            break
        out.append(now)
    return out


def _earlier(told, layer, before, ended):
    out = {}
    for label, (c, presence) in told.items():
        c = layer["parent"][c]
        if c >= 0:
            out[label] = (c, max(presence, before["presence"][before["target"][c]]))
    for c in ended:
        t = before["target"][c]
        out[before["label"][t]] = (c, before["presence"][t])
    return out


def _tellable(told, layer, least):
    believed = dict(zip(layer["label"], layer["believed"], strict=True))
    some = {label: (c, presence >= least) for label, (c, presence) in told.items()}
    return {label: rest for label, rest in some.items() if rest[1] or believed[label] >= least}
