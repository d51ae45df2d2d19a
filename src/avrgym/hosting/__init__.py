"""Host a study for participants at home: many concurrent sessions, with one public address.

The host is one process with two web servers: a public server for participants, and a server for experimenters on
another port. Each session runs in a separate process (``session_process``), with the server of ``avrgym serve``. The
host starts these processes, monitors them and replaces crashed ones (``session_pool``). It admits participants by
measured capacity (``capacity``, ``waiting_list``), and forwards WebSockets to sessions as bytes (``tunnel``).

The study's database contains invitations, consents, inclusion answers, events and trials. A participant's stage, which
is the next step in the study, is computed from them (``stages``). A private file contains the waiting list, the links
of running sessions, and whether the study is open (``host_state``). After a crash of the host, its sessions start again
at the same addresses. After each crash, a session continues with the first incomplete trial.

| module | task |
|---|---|
| ``settings`` | contents of ``host.toml`` |
| ``host_state`` | state that remains after a restart of the host: ``private/host.json`` |
| ``public_links`` | public address and links |
| ``rate_limits``, ``headset_codes`` | limits of requests, codes for headsets |
| ``stages`` | next step of a participant |
| ``capacity``, ``waiting_list`` | admission and waiting time |
| ``session_process``, ``session_pool`` | processes of sessions and their supervision |
| ``tunnel`` | WebSockets between browser and session |
| ``make_participant_app``, ``make_experimenter_app`` | web applications of both servers |
| ``data_requests`` | deletion and copies of data on request |
| ``host`` | the host with both servers |
"""
