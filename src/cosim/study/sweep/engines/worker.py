"""A process of a sweep, asked and answering through pipes."""

import pickle

from cosim.host.inside import Conversation, look_where_the_parent_does
from cosim.study.sweep.chunk import compute_chunk


def serve(conversation: Conversation) -> None:
    """Take a `Job`, then answer chunks until nobody asks any more."""
    job = None
    for question in conversation.questions():
        try:
            if job is None:
                job = pickle.loads(question)
                conversation.answer(pickle.dumps(None))
            else:
                first, columns = pickle.loads(question)
                conversation.answer(_packed(compute_chunk(job, first, columns)))
        except Exception as error:
            conversation.answer(_packed(error))


def _packed(value: object) -> bytes:
    try:
        return pickle.dumps(value)
    except Exception:  # an error of somebody else's that cannot be sent
        return pickle.dumps(RuntimeError(f"{type(value).__name__}: {value}"))


if __name__ == "__main__":
    look_where_the_parent_does()
    serve(Conversation())
