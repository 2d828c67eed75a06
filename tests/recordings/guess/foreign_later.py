"""Ten files more, written after the vocabulary was fixed on the twenty of `foreign.py`: what a first guess is worth on
names that nobody looked at before (French and German benches, control units, CANape, AVL, service tools)."""

from __future__ import annotations

from foreign import Foreign, file_of

LATER: tuple[Foreign, ...] = (
    file_of("a French test bench", """
        Temps | s | time_s |
        Régime moteur | tr/min | n_e_rpm |
        Couple moteur | N.m | torque_nm |
        Débit carburant | kg/h | fuel | kg/h
        Position vanne EGR | % | u_egr_pct | %
        Position TGV | % | u_vgt_pct | %
        Pression collecteur admission | mbar | p_im_pa | mbar
        Pression avant turbine | mbar | p_em_pa | mbar
        Pression après turbine | mbar | p after | mbar
        Régime turbo | tr/min | omega_t_rad_s | rpm of rad/s
        Débit EGR | kg/h | w_egr_kg_s | kg/h
        Température avant turbine | °C | t_em_k | degC
        Température après turbine | °C | t after | degC
        Débit d'air | kg/h | w_c_kg_s | kg/h
        Température air admission | °C | t_im_k | degC
        Pression atmosphérique | mbar | p_amb_pa | mbar
        Température ambiante | °C | t_amb_k | degC
        Température eau moteur | °C | coolant | degC
        Température huile | °C | oil | degC""", row=True),
    file_of("French abbreviations", """
        Tps | ms | time_s |
        N_mot | tr/mn | n_e_rpm |
        Q_inj | mg/cp | u_delta_mg |
        Pos_EGR | % | u_egr_pct | %
        Pos_TGV | % | u_vgt_pct | %
        P_suralim | hPa | p_im_pa | hPa
        Cons_suralim | hPa | boost wanted | hPa
        P_avt | hPa | p_em_pa | hPa
        P_apt | hPa | p after | hPa
        N_turbo | tr/mn | omega_t_rad_s | rpm of rad/s
        Qm_EGR | kg/h | w_egr_kg_s | kg/h
        T_avt | °C | t_em_k | degC
        T_apt | °C | t after | degC
        Qm_air | kg/h | w_c_kg_s | kg/h
        T_coll_adm | °C | t_im_k | degC
        P_atm | hPa | p_amb_pa | hPa
        T_eau | °C | coolant | degC""", row=True),
    file_of("an AVL bench", """
        RECTIME | s | time_s |
        SPEED | rpm | n_e_rpm |
        TORQUE | Nm | torque_nm |
        FB_VAL | kg/h | fuel | kg/h
        EGR_POS_ACT | % | u_egr_pct | %
        VGT_POS_ACT | % | u_vgt_pct | %
        P_INTM | kPa | p_im_pa | kPa
        P_EXM | kPa | p_em_pa | kPa
        P_EXH_ATC | kPa | p after | kPa
        N_TC | rpm | omega_t_rad_s | rpm of rad/s
        M_EGR | kg/h | w_egr_kg_s | kg/h
        T_EXH_BTC | degC | t_em_k | degC
        T_EXH_ATC | degC | t after | degC
        MF_AIR | kg/h | w_c_kg_s | kg/h
        T_INTM | degC | t_im_k | degC
        P_BARO | kPa | p_amb_pa | kPa
        T_CELL | degC | t_amb_k | degC
        T_OIL | degC | oil | degC
        T_WAT_OUT | degC | coolant | degC""", row=True),
    file_of("an older Bosch control unit", """
        time | s | time_s |
        dzmNmit | U/min | n_e_rpm |
        mrmM_EAKT | mg/Hub | u_delta_mg |
        armM_List | mg/Hub | air per stroke | mg
        ldmP_Llin | mbar | p_im_pa | mbar
        ldmP_Lsoll | mbar | boost wanted | mbar
        ldmADF | mbar | p_amb_pa | mbar
        anmLTF | °C | t_im_k | degC
        anmWTF | °C | coolant | degC
        anmUTF | °C | t_amb_k | degC""", row=True),
    file_of("CANape, AUTOSAR names", """
        t | s | time_s |
        EngN_Act | rpm | n_e_rpm |
        InjSys_mTotPerStrk | mg/hub | u_delta_mg |
        EGRVlvActr_posnActVal | % | u_egr_pct | %
        EGRVlvActr_posnSetp | % | egr wanted | %
        TrbVarGeomActr_posnActVal | % | u_vgt_pct | %
        AirSys_pIntkMnfldAbs | hPa | p_im_pa | hPa
        ExhSys_pUsTrb | hPa | p_em_pa | hPa
        ExhSys_pDsTrb | hPa | p after | hPa
        TrbChrg_nShaft | rpm | omega_t_rad_s | rpm of rad/s
        AirSys_mfEGR | kg/h | w_egr_kg_s | kg/h
        ExhSys_tUsTrb | degC | t_em_k | degC
        ExhSys_tDsTrb | degC | t after | degC
        AirSys_mfFreshAir | kg/h | w_c_kg_s | kg/h
        AirSys_tIntkMnfld | degC | t_im_k | degC
        EnvSys_pBaro | hPa | p_amb_pa | hPa
        EnvSys_tAmb | degC | t_amb_k | degC
        CoolSys_tEngOut | degC | coolant | degC""", row=True),
    file_of("an American service tool", """
        Elapsed Time (s) | | time_s |
        Engine RPM | | n_e_rpm |
        Fuel Delivery (mg/stroke) | | u_delta_mg |
        EGR Valve Position Measured (percent) | | u_egr_pct | %
        VG Turbo Actuator Position Measured (percent) | | u_vgt_pct | %
        Intake Manifold Pressure (psi) | | p_im_pa | psi gauge
        Exhaust Gas Pressure (psi) | | p_em_pa | psi gauge
        Turbocharger Speed (rpm) | | omega_t_rad_s | rpm of rad/s
        EGR Flow Rate (lb/min) | | w_egr_kg_s | lb/min
        Exhaust Manifold Temperature (°F) | | t_em_k | degF
        Fresh Air Flow (lb/min) | | w_c_kg_s | lb/min
        Intake Manifold Air Temperature (°F) | | t_im_k | degF
        Barometric Air Pressure (psi) | | p_amb_pa | psi
        Engine Coolant Temperature (°F) | | coolant | degF
        Engine Oil Temperature (°F) | | oil | degF
        Fuel Rail Pressure (psi) | | rail | psi"""),
    file_of("German measuring blocks", """
        Zeit (s) | | time_s |
        Motordrehzahl G28 (/min) | | n_e_rpm |
        Einspritzmenge Istwert (mg/H) | | u_delta_mg |
        AGR-Ventil Istposition (%) | | u_egr_pct | %
        Ladedrucksteller Istposition (%) | | u_vgt_pct | %
        Ladedruck Istwert (mbar) | | p_im_pa | mbar
        Ladedruck Sollwert (mbar) | | boost wanted | mbar
        Luftmasse Istwert (mg/H) | | air per stroke | mg
        Abgastemperatur vor Turbolader G235 (°C) | | t_em_k | degC
        Abgasdruck vor Turbolader (mbar) | | p_em_pa | mbar
        Saugrohrtemperatur G72 (°C) | | t_im_k | degC
        Umgebungsluftdruck (mbar) | | p_amb_pa | mbar
        Kühlmitteltemperatur G62 (°C) | | coolant | degC
        Fahrzeuggeschwindigkeit (km/h) | | vehicle | """),
    file_of("rapid control prototyping, no units", """
        tSim | | time_s |
        nEng | | n_e_rpm |
        qInj | | u_delta_mg |
        rEGR | | u_egr_pct | %
        rVGT | | u_vgt_pct | %
        pIntkMnf | | p_im_pa | kPa
        pExhMnf | | p_em_pa | kPa
        nTC | | omega_t_rad_s | krpm of rad/s
        mfEGR | | w_egr_kg_s | kg/h
        TExhMnf | | t_em_k | degC
        mfAir | | w_c_kg_s | kg/h
        TIntkMnf | | t_im_k | degC
        pAmb | | p_amb_pa | kPa
        TAmb | | t_amb_k | degC
        TCool | | coolant | degC
        TOil | | oil | degC"""),
    file_of("an exhaust laboratory, German", """
        Laufzeit | s | time_s |
        n_Mot | min-1 | n_e_rpm |
        M_Mot | Nm | torque_nm |
        B_KS | kg/h | fuel | kg/h
        Stellung AGR-Klappe | % | u_egr_pct | %
        Stellung Leitapparat | % | u_vgt_pct | %
        p2' | bar | p_im_pa | bar
        p3 | bar | p_em_pa | bar
        p4 | bar | p after | bar
        n_ATL | 1/min | omega_t_rad_s | rpm of rad/s
        m_AGR | kg/h | w_egr_kg_s | kg/h
        T3 | °C | t_em_k | degC
        T4 | °C | t after | degC
        m_Luft | kg/h | w_c_kg_s | kg/h
        T2' | °C | t_im_k | degC
        p0 | mbar | p_amb_pa | mbar
        T0 | °C | t_amb_k | degC""", row=True),
    file_of("a data logger on a ship", """
        Date/Time | s | time_s |
        ME RPM | rpm | n_e_rpm |
        ME FUEL FLOW | L/h | fuel | L/h
        ME EGR VALVE OPENING | % | u_egr_pct | %
        ME VTA POSITION | % | u_vgt_pct | %
        ME SCAV AIR PRESS | bar | p_im_pa | bar gauge
        ME EXH GAS RECEIVER PRESS | bar | p_em_pa | bar gauge
        ME TC RPM | rpm | omega_t_rad_s | rpm of rad/s
        ME EXH GAS TC INLET TEMP | degC | t_em_k | degC
        ME EXH GAS TC OUTLET TEMP | degC | t after | degC
        ME SCAV AIR TEMP | degC | t_im_k | degC
        ME AIR FLOW | kg/s | w_c_kg_s | kg/s
        ER AMBIENT PRESS | mbar | p_amb_pa | mbar
        ER AMBIENT TEMP | degC | t_amb_k | degC
        ME LO INLET TEMP | degC | oil | degC""", row=True),
)  # fmt: skip
