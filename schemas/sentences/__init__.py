"""Words for people, in English: the one place that makes sentences of codes and of their numbers."""

from tilth.schemas.sentences.advice import MANOEUVRES as MANOEUVRES
from tilth.schemas.sentences.advice import advice_sentence as advice_sentence
from tilth.schemas.sentences.advice import combination_words as combination_words
from tilth.schemas.sentences.diagnosis import DIAGNOSES as DIAGNOSES
from tilth.schemas.sentences.notices import event_sentence as event_sentence
from tilth.schemas.sentences.notices import notice_sentence as notice_sentence
from tilth.schemas.sentences.reasons import SENTENCES as SENTENCES
from tilth.schemas.sentences.reasons import sentence as sentence
from tilth.schemas.sentences.rejections import rejection_sentence as rejection_sentence
from tilth.schemas.sentences.soil import soil_words as soil_words
