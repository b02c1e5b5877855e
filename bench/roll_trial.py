"""ev.py LOG...: collects records from a log, then runs the tracker and pem over stretches without gating."""
import sys, json, math, time, os
os.environ.setdefault("OMP_NUM_THREADS","1")
sys.path.insert(0,'bench')
import numpy as np
from pathlib import Path
from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT, NAMES
from tilth.estimator.methods import tracker, pem
from tilth.estimator.record import record_builder
from tilth.replay.readers.any_log import frames
from tilth.logger.machine_file import read_machine
machine,_=read_machine(Path('deploy/machines/jd7930-parker500.toml'))
P=["C_af","C_ar","C_ai","sigma_f","sigma_r","sigma_i"]
def collect(log):
    """stretches by hooking record_builder.observe"""
    out=[]
    orig=record_builder.observe
    def hook(*a,**k):
        s=orig(*a,**k); out.append(s); return s
    record_builder.observe=hook
    try:
        st=fold.initial(machine); st.ready=False
        for f in frames(log): fold.step(st,f)
    finally: record_builder.observe=orig
    return [s for s in out if s is not None]
from dataclasses import replace
from tilth.estimator.record.record import Record
SDR=float(os.environ.get("SDR","0.005"))
def with_roll(st):
    r=st.record
    if not len(r.ticks): return st
    rows=[r.rows]
    for k in (0,5):
        for b in (0,1): rows.append(np.array([[k,0.0,5,b,r.ticks[k,6+b],SDR]]))
    rows=np.concatenate(rows); rows=rows[np.argsort(rows[:,0]+rows[:,1]/0.02,kind="stable")]
    return replace(st,record=Record(r.t_ns,r.ticks,np.ascontiguousarray(rows)))
for log in sys.argv[1:]:
    truth=json.load(open(log+'.truth.json'))["parameters"]
    t=np.log([truth[p] for p in P])
    cache=log+'.stretches.npy'
    ss=[with_roll(x) for x in collect(log)]
    ts=tracker.initial(machine)
    for s in ss: tracker.take_segment(ts,machine,s)
    cov=ts.covariance[:6,:6]; sd=np.sqrt(np.diag(cov))*1.3
    e=ts.mean[:6]-t
    print(Path(log).stem, 'tracker', ' '.join(f'{100*(math.exp(x)-1):+4.0f}({abs(x)/s:.1f})' for x,s in zip(e,sd)), 'roll', *( [f'{n}={ts.mean[AT[n]]:+.2f}({math.sqrt(ts.covariance[AT[n],AT[n]]):.2f})' for n in NAMES if n.startswith('roll_')]),flush=True)
    # pem over windows
    mean,psd=unknowns.prior(machine); covm=np.diag(psd**2)
    ws=[];cur=[]
    for s in ss:
        if s.reason: cur=[]; continue
        cur.append(s)
        if len(cur)==150: ws.append(cur); cur=[]
    from tilth.estimator.record.record import concatenate
    st=pem.initial(machine); T=0
    for w in ws[:4]:
        r=concatenate(w)
        job=pem.Job(0,0,r,st.mean,st.covariance.copy())
        c=pem._drifted(st)[1]; job=pem.Job(0,0,r,st.mean.copy(),c)
        t0=time.time(); f=pem.fit(machine,job); T+=time.time()-t0
        if f.refused: print('  refused',f.refused); continue
        st.mean,st.covariance=f.mean,f.covariance; st.fits+=1
    sd=np.sqrt(np.diag(st.covariance[:6,:6])); e=st.mean[:6]-t
    print(Path(log).stem, 'pem    ', ' '.join(f'{100*(math.exp(x)-1):+4.0f}({abs(x)/s:.1f})' for x,s in zip(e,sd)), f'{T:.1f}s', 'roll', *( [f'{n}={st.mean[AT[n]]:+.2f}({math.sqrt(st.covariance[AT[n],AT[n]]):.2f})' for n in NAMES if n.startswith('roll_')]),flush=True)
