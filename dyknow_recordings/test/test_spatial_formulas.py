"""Spatial operators over recordings: positions with units, and who reaches whom."""

from __future__ import annotations

from pathlib import Path

from running_checks import run_check

ONTOLOGY = """\
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix : <http://example.org/r#> .
<http://example.org/r> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:Robot a owl:Class ; rdfs:subClassOf dyknow:Object .
:r1 a :Robot . :r2 a :Robot . :r3 a :Robot .
:X a owl:Class ; rdfs:subClassOf dyknow:Feature ; dyknow:argument1 :Robot ;
  dyknow:value_type "float" ; dyknow:unit "m" .
:Base a owl:Class ; rdfs:subClassOf dyknow:Feature ; dyknow:argument1 :Robot ;
  dyknow:value_type "boolean" .
"""
TRACE = """\
time_s,X[r1],X[r2],X[r3],Base[r1],Base[r2],Base[r3]
0,0,30,60,true,false,false
1,0,35,65,true,false,false
2,0,38,92,true,false,false
"""
LINKS = 'over (abs(X[a] - X[b]) <= 5000 cm for a, b in Robot) from r to s:'


def test_who_reaches_the_base(tmp_path: Path) -> None:
    (tmp_path / 'r.ttl').write_text(ONTOLOGY, encoding='utf-8')
    (tmp_path / 'flight.csv').write_text(TRACE, encoding='utf-8')
    formulas = [
        f'forall r in Robot: always {LINKS} somewhere[0, 0.1 km] Base[s]',
        f'forall r in Robot: {LINKS} somewhere[0, 2 hops] eventually[0 s, 1 s] Base[s]',
    ]
    options = ['--ontology', tmp_path / 'r.ttl', '--json']
    options += [word for each in formulas for word in ('--formula', each)]
    first, second = run_check(tmp_path / 'flight.csv', *options).formulas
    assert [first['outcome'], second['outcome']] == ['false', 'true']
    assert first['episodes'][0]['explanation'] == (
        "for r = r3: at 2.000 s, r3 reaches no object in [0, 0.1 km] where 'Base[s]' holds; no "
        'link leads from it, and the next is missing, as abs(X[r3] - X[r2]) = 54 (always must hold '
        'since 0.000 s)'
    )
