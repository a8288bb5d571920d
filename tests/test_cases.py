import pytest

from tests.cases import each


def test_all_failing_cases_are_listed(tmp_path):
    @each("number", [1, 2, 3])
    @each("word, sign", [("a", 1), ("b", -1)])
    def check(number, word, sign, tmp_path):
        assert tmp_path.exists()
        assert number * sign < 3, f"{word} {number}"
        assert (number, word) != (1, "b")

    with pytest.raises(AssertionError) as caught:
        check(tmp_path=tmp_path)
    text = str(caught.value)
    assert text.startswith("2 of 3 cases fail:")
    assert "{'number': 1}" in text and "{'number': 3}" in text and "{'number': 2}" not in text
    assert "a 3" in text


@each("value", [1, 2])
def test_fixtures_and_cases_go_together(value, tmp_path):
    assert tmp_path.exists() and value in (1, 2)


@each("name", ["a", "b"], copied="tmp_path")
def test_a_case_may_change_its_copy_of_a_folder(name, tmp_path):
    assert list(tmp_path.iterdir()) == []
    (tmp_path / name).touch()
