"""Host a study for participants at home: many concurrent sessions, with one public address.

The host is one process. It has two web servers: a public one for participants, and one on another port for
experimenters. Each session runs in its own process (``session_process``), with the same server and the same session as
``avrgym serve``. The host starts these processes, watches and replaces them (``session_pool``), admits participants by
measured capacity (``capacity``, ``waiting_list``), and passes WebSockets to them as bytes (``tunnel``).

Invitations, consents, inclusion answers, events and trials are in the study's database. A participant's stage is
computed from them (``stages``). Door, waiting list and links of running sessions are in a private file
(``host_state``). After a crash of the host, its sessions start again at the same addresses. After each crash, a session
continues with the first trial that is not complete.

| module | task |
|---|---|
| ``settings`` | contents of ``host.toml`` |
| ``host_state`` | what a restart of the host continues: ``private/host.json`` |
| ``addresses`` | public address and links |
| ``rate_limits``, ``headset_codes`` | limits of requests, codes for headsets |
| ``stages`` | what a participant does next |
| ``capacity``, ``waiting_list`` | admission and waiting time |
| ``session_process``, ``session_pool`` | processes of sessions and their supervision |
| ``tunnel`` | WebSockets between browser and session |
| ``participant_app``, ``experimenter_app`` | web applications of both servers |
| ``data_requests`` | deletion and copies of data on request |
| ``host`` | both servers together |
"""
