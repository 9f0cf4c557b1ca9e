import pytest

from msg_adapters.errors import BagError, MalformedMessage


@pytest.mark.parametrize('error', [BagError, MalformedMessage])
def test_names_from_a_damaged_message_cannot_break_the_line(error):
    assert str(error("no field 'a\nb\x1b[31m' in /größe")) == "no field 'a b [31m' in /größe"
    assert isinstance(error('x'), ValueError)
