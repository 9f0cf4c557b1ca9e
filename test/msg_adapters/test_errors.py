import pytest

from msg_adapters.errors import BagError, MalformedMessage


@pytest.mark.parametrize('error', [BagError, MalformedMessage])
def test_names_from_a_damaged_message_cannot_break_the_line(error):
    assert str(error("no field 'a\nb\x1b[31m' in /größe")) == "no field 'a b [31m' in /größe"
    assert isinstance(error('x'), ValueError)


@pytest.mark.parametrize('error', [BagError, MalformedMessage])
def test_a_name_without_end_does_not_fill_the_log(error):
    assert len(str(error(f'encoding {"9" * 10**6}'))) < 2100
