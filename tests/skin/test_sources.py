from skin.sources import DEFAULT_OBJECTS, OBJECT_GROUPS, known_objects, object_names


def test_a_group_is_named_among_objects() -> None:
    assert object_names(["ring,paper", "cup"]) == ("ring", *OBJECT_GROUPS["paper"])
    assert object_names([""]) == ()


def test_a_classifier_knows_the_default_objects_but_for_a_whole_group() -> None:
    assert known_objects([]) == DEFAULT_OBJECTS
    assert known_objects(["cup", "ring"]) == (*DEFAULT_OBJECTS, "cup")
    assert known_objects(object_names(["paper"])) == OBJECT_GROUPS["paper"]
