"""Who may do what on the bus: Zenoh's access control, made from `keys`. The default is no.

It is enforced by the session that others connect to, at each link: on what comes in (ingress) and
on what goes out (egress), by the common name of the certificate on the other side. Deleting is
nobody's right.
"""

from collections.abc import Iterator, Mapping, Sequence

from otc_dist.bus.keys import HOST, OBSERVER, Keys, Uses

# What a use needs: (field of Uses, Zenoh's messages that come in, those that go out).
_NEEDS = (
    ("publishes", ("put",), ("declare_subscriber",)),
    ("hears", ("declare_subscriber",), ("put",)),
    ("asks", ("query",), ("reply", "declare_queryable")),
    ("answers", ("reply", "declare_queryable"), ("query",)),
    ("shows", ("liveliness_token",), ("liveliness_query", "declare_liveliness_subscriber")),
    ("watches", ("liveliness_query", "declare_liveliness_subscriber"), ("liveliness_token",)),
)


def router_rules(keys: Keys, agents: Sequence[str]) -> dict[str, object]:
    """Zenoh's `access_control` section for a router at which all processes of a run meet."""
    learners = {agent: keys.learner_uses(agent) for agent in agents}
    observer = keys.observer_uses(agents)
    return access_control({HOST: keys.host_uses(agents), **learners, OBSERVER: observer})


def host_rules(keys: Keys, agents: Sequence[str]) -> dict[str, object]:
    """The same for the env host where it is the centre, with its launcher on the same machine."""
    learners = {agent: keys.learner_uses(agent) for agent in agents}
    observer = keys.observer_uses(agents)
    return access_control({**learners, OBSERVER: observer}, local=observer)


def access_control(by_name: Mapping[str, Uses], local: Uses | None = None) -> dict[str, object]:
    """Zenoh's `access_control` section.

    Args:
        by_name: what is allowed, by the certificates' common names.
        local: what is allowed through the private socket of this machine, if there is one.
    """
    subjects: dict[str, tuple[dict[str, object], Uses]] = {
        name: ({"id": name, "cert_common_names": [name], "link_protocols": ["tls"]}, uses)
        for name, uses in by_name.items()
    }
    if local is not None:
        protocols = ["unixsock-stream"]
        subjects["local"] = ({"id": "local", "link_protocols": protocols}, local)
    rules, policies = [], []
    for name, (_, uses) in subjects.items():
        own = list(_rules(name, uses))
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [subject for subject, _ in subjects.values()],
        "policies": policies,
    }


def _rules(name: str, uses: Uses) -> Iterator[dict[str, object]]:
    for use, comes_in, goes_out in _NEEDS:
        keys: tuple[str, ...] = getattr(uses, use)
        for flow, messages in (("ingress", comes_in), ("egress", goes_out)):
            if keys:
                yield {
                    "id": f"{name} {use}, {flow}",
                    "permission": "allow",
                    "flows": [flow],
                    "messages": list(messages),
                    "key_exprs": list(keys),
                }
