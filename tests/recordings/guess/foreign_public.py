"""Fifteen files with names that stand in public sources, judged once before anything was mended on them.

Every name is one that a public repository uses: labels of control units (a MATLAB script that maps measurements to a
model, a decoding table of a bus), diagnosis interfaces (EDIABAS, enhanced parameters of an American pick-up, measuring
blocks in Spanish and Swedish), phone apps, logs of tuning tools, ships (a performance database, a monitoring tool) and
an inspection station. The values are the simulated drive's; what a name stands for is what its source says.
"""

from __future__ import annotations

from foreign import Foreign, file_of

PUBLIC: tuple[Foreign, ...] = (
    file_of("labels of a truck's control unit", """
        time | s | time_s |
        Epm_nEng | rpm | n_e_rpm |
        InjCrv_qSetUnBal | mg/str | u_delta_mg |
        TrbCh_rAct | % | u_vgt_pct | %
        EGRVlv_rAct | % | u_egr_pct | %
        ThrVlv_rAct | % | torque % | %
        AFS_dm | kg/h | w_c_kg_s | kg/h
        AirCtl_dmAirDesDyn_r32 | kg/h | air wanted | kg/h
        Air_pIntkVUs | hPa | p_im_pa | hPa
        PCR_pDesVal | hPa | boost wanted | hPa
        TrbCh_n | rpm | omega_t_rad_s | rpm of rad/s
        Air_tCACDs | degC | t_im_k | degC
        T3LimCL_tTrbnUs_mp | degC | t_em_k | degC
        Exh_tOxiCatUs | degC | t after | degC
        EnvP_p | hPa | p_amb_pa | hPa
        EnvT_t | degC | t_amb_k | degC
        RailP_pFlt | hPa | rail | hPa
        ActMod_trqCrS | Nm | torque_nm |
        PthSet_trqInrSet | Nm | torque wanted |
        VehV_v | km/h | vehicle |
        APP_r | % | pedal | %""", row=True),
    file_of("names of a truck's model", """
        time | s | time_s |
        TrsmMdl_nCrksft_PHY | Rpm | n_e_rpm |
        ECU_qInjTot_PHY | mg/str | u_delta_mg |
        ECU_prcTrbVlvDes_PHY | % | u_vgt_pct | %
        ECU_prcEgrVlvDes_PHY | % | u_egr_pct | %
        ECU_prcThrVlvDes_PHY | % | torque % | %
        EngMdl_mflChrgdAir_PHY | kg/sec | w_c_kg_s | kg/s
        ECU_mflChrgdAirDes_PHY | kg/sec | air wanted | kg/s
        EngMdl_pIntkMnfld_PHY | Pa | p_im_pa | Pa
        ECU_pIntkMnfldDes_PHY | Pa | boost wanted | Pa
        EngMdl_nTrbn_PHY | rpm | omega_t_rad_s | rpm of rad/s
        EngMdl_tIntkMnfld_PHY | degC | t_im_k | degC
        EngMdl_tExhMnfld_PHY | degC | t_em_k | degC
        EngMdl_tTrbDs_PHY | degC | t after | degC
        EngMdl_pFuRail_PHY | Pa | rail | Pa
        EnvMdl_pEnv_PHY | Pa | p_amb_pa | Pa
        EnvMdl_tEnv_PHY | degC | t_amb_k | degC
        EngMdl_trqEngTqOut_PHY | Nm | torque_nm |
        ECU_trqEngSetInr_PHY | Nm | torque wanted |
        LgtVehMdl_vVehSpd_PHY | km/h | vehicle |
        DrvrMdl_prcAccrPedlPosn_PHY | % | pedal | %""", row=True),
    file_of("a German diagnosis interface", """
        time | s | time_s |
        STAT_MOTORDREHZAHL_WERT | rpm | n_e_rpm |
        STAT_LADEDRUCK_IST_WERT | hPa | p_im_pa | hPa
        STAT_LADEDRUCK_SOLL_WERT | hPa | boost wanted | hPa
        STAT_ATMOSPHAERENDRUCK_WERT | hPa | p_amb_pa | hPa
        STAT_LMM_MASSE_WERT | kg/h | w_c_kg_s | kg/h
        STAT_LUFTMASSE_SOLL_WERT | mg/hub | air wanted per stroke | mg
        STAT_LADELUFTTEMPERATUR_WERT | degC | t_im_k | degC
        STAT_UMGEBUNGSTEMPERATUR_WERT | degC | t_amb_k | degC
        STAT_KUEHLMITTELTEMPERATUR_WERT | degC | coolant | degC
        STAT_KRAFTSTOFFTEMPERATUR_WERT | degC | t fuel | degC
        STAT_ABGASTEMPERATUR_VOR_KATALYSATOR_WERT | degC | t after | degC
        STAT_RAILDRUCK_IST_WERT | bar | rail | bar""", row=True),
    file_of("enhanced parameters of an American pick-up", """
        Time | s | time_s |
        Engine RPM | rpm | n_e_rpm |
        Fuel Injection Quantity | mm³/stroke | mm3 |
        Commanded Boost Pressure | kPa | boost wanted | kPa
        Actual Boost Pressure | kPa | p_im_pa | kPa
        VGT Turbo Vane Position Commanded | % | vgt wanted | %
        VGT Turbo Vane Position Actual | % | u_vgt_pct | %
        Turbo Speed | rpm | omega_t_rad_s | rpm of rad/s
        Charge Air Cooler Outlet Temp | °C | t_im_k | degC
        EGT Bank 1 Sensor 1 (Pre-Turbo) | °C | t_em_k | degC
        EGT Bank 1 Sensor 2 (Post-Turbo) | °C | t after | degC
        EGR Mass Flow Rate | kg/h | w_egr_kg_s | kg/h
        Actual Fuel Rail Pressure | MPa | rail | MPa
        Engine Oil Temperature | °C | oil | degC
        Engine Oil Pressure | kPa | oil pressure | kPa
        Transmission Input Speed | rpm | shaft |
        MAF | g/s | w_c_kg_s | g/s
        Barometric | kPa | p_amb_pa | kPa""", row=True),
    file_of("the same pick-up, short names", """
        Time | s | time_s |
        RPM | rpm | n_e_rpm |
        INJ_QTY | mm³/stroke | mm3 |
        BOOST_CMD | kPa | boost wanted | kPa
        BOOST_ACT | kPa | p_im_pa | kPa
        VGT_CMD | % | vgt wanted | %
        VGT_ACT | % | u_vgt_pct | %
        TURBO_RPM | rpm | omega_t_rad_s | rpm of rad/s
        CAC_OUT | °C | t_im_k | degC
        EGT_PRE | °C | t_em_k | degC
        EGT_POST | °C | t after | degC
        EGR_FLOW | kg/h | w_egr_kg_s | kg/h
        FRP_ACT | MPa | rail | MPa
        EOT | °C | oil | degC
        EOP | kPa | oil pressure | kPa
        TRANS_IN | rpm | shaft |
        MAF | g/s | w_c_kg_s | g/s""", row=True),
    file_of("monitoring of a ship's main engine", """
        timestamp | s | time_s |
        engine_rpm | RPM | n_e_rpm |
        engine_load_pct | % | torque % | %
        tc_rpm | RPM | omega_t_rad_s | rpm of rad/s
        tc_exh_inlet_temp_c | °C | t_em_k | degC
        tc_exh_outlet_temp_c | °C | t after | degC
        scav_air_pressure_bar | bar | p_im_pa | bar gauge
        scav_air_temp_c | °C | t_im_k | degC
        jcw_outlet_temp_c | °C | coolant | degC
        lo_inlet_temp_c | °C | oil | degC
        lo_pressure_bar | bar | oil pressure | bar gauge""", row=True),
    file_of("a ship's performance database", """
        time_s | | time_s |
        engine_speed_rpm | | n_e_rpm |
        load_percentage | | torque % | %
        barometer_pressure_mbar | | p_amb_pa | mbar
        room_temperature_c | | t_amb_k | degC
        scav_air_temperature_c | | t_im_k | degC
        exh_temp_tc_inlet_c | | t_em_k | degC
        exh_temp_tc_outlet_c | | t after | degC
        turbocharger_speed_x1000_rpm | | omega_t_rad_s | krpm of rad/s
        scav_air_pressure_bar | | p_im_pa | bar gauge
        turbocharger_gas_inlet_press_kg_cm2 | | p_em_pa | kg/cm2 gauge
        fuel_oil_temperature_c | | t fuel | degC
        fuel_oil_consumption_kg_h | | fuel | kg/h"""),
    file_of("measuring blocks in Spanish", """
        Tiempo | s | time_s |
        Revoluciones del motor | 1/min | n_e_rpm |
        Cantidad de inyección | mg/str | u_delta_mg |
        Masa de aire real | mg/str | air per stroke | mg
        Masa de aire objetivo EGR | mg/str | air wanted per stroke | mg
        Presión de turbo solicitada | kPa | boost wanted | kPa
        Presión de turbo real | kPa | p_im_pa | kPa
        Presión barométrica | kPa | p_amb_pa | kPa
        Mando de la EGR | % | u_egr_pct | %
        Mando del turbo | % | u_vgt_pct | %
        Par calculado del motor | Nm | torque_nm |
        Par solicitado por el conductor | Nm | torque wanted |
        Temperatura del aire de admisión | °C | t_im_k | degC
        Temperatura ambiente | °C | t_amb_k | degC
        Temperatura del combustible | °C | t fuel | degC
        Temperatura del aceite | °C | oil | degC
        Posición del pedal | % | pedal | %
        Presión del rail real | bar | rail | bar""", row=True),
    file_of("measuring blocks in Swedish", """
        Tid | s | time_s |
        Varvtal | 1/min | n_e_rpm |
        Insprutad mängd | mg/H | u_delta_mg |
        Luftmassa BÖR | mg/H | air wanted per stroke | mg
        Luftmassa ÄR | mg/H | air per stroke | mg
        EGR-ventil styrgrad | % | u_egr_pct | %
        Laddtryck BÖR | mbar | boost wanted | mbar
        Laddtryck ÄR | mbar | p_im_pa | mbar
        Styrgrad N75 laddtryck | % | u_vgt_pct | %
        Atmosfärtryck | mbar | p_amb_pa | mbar
        Insugslufttemperatur | °C | t_im_k | degC
        Kylvätsketemperatur | °C | coolant | degC
        Bränsletemperatur | °C | t fuel | degC
        Gaspedalläge | % | pedal | %""", row=True),
    file_of("a phone app without units", """
        timestamp | | time_s |
        rpm | | n_e_rpm |
        speed | | vehicle |
        coolantTemp | | coolant | degC
        boostPressure | | p_im_pa | kPa
        turboRpm | | omega_t_rad_s | rpm of rad/s
        chargeAirCoolerTemp | | t_im_k | degC
        turboVgtPosition | | u_vgt_pct | %
        turboCompOutletTemp | | t cooler | degC
        turboTurbineInletTemp | | t_em_k | degC
        turboTurbineOutletTemp | | t after | degC
        turboOilPressure | | oil pressure | kPa"""),
    file_of("a monitoring program", """
        timestamp | s | time_s |
        engine_speed | RPM | n_e_rpm |
        engine_load | % | torque % | %
        throttle_position | % | pedal | %
        fuel_flow_rate | L/h | fuel | L/h
        engine_torque | Nm | torque_nm |
        coolant_temp | °C | coolant | degC
        oil_temp | °C | oil | degC
        exhaust_temp | °C | t_em_k | degC
        intake_air_temp | °C | t_im_k | degC
        oil_pressure | bar | oil pressure | bar gauge
        fuel_pressure | bar | rail | bar
        boost_pressure | bar | p_im_pa | bar
        exhaust_pressure | bar | p after | bar gauge
        egr_valve_position | % | u_egr_pct | %
        turbo_vane_position | % | u_vgt_pct | %""", row=True),
    file_of("the same program in Chinese", """
        timestamp | s | time_s |
        发动机转速 | RPM | n_e_rpm |
        发动机负载 | % | torque % | %
        油门位置 | % | pedal | %
        燃油流量 | L/h | fuel | L/h
        输出扭矩 | Nm | torque_nm |
        冷却液温度 | °C | coolant | degC
        机油温度 | °C | oil | degC
        排气温度 | °C | t_em_k | degC
        进气温度 | °C | t_im_k | degC
        机油压力 | bar | oil pressure | bar gauge
        燃油压力 | bar | rail | bar
        增压压力 | bar | p_im_pa | bar
        排气背压 | bar | p after | bar gauge
        EGR阀位置 | % | u_egr_pct | %
        涡轮叶片位置 | % | u_vgt_pct | %""", row=True),
    file_of("the log of a tuning tool", """
        Offset | s | time_s |
        Engine RPM | rpm | n_e_rpm |
        Mass Airflow | lb/min | w_c_kg_s | lb/min
        Intake Manifold Absolute Pressure | psi | p_im_pa | psi
        Desired Boost | psi | boost wanted | psi
        Engine Fuel Rate | gal/h | fuel | gal/h
        Turbo Vane Position | % | u_vgt_pct | %
        Desired Turbo Vane Position | % | vgt wanted | %
        Exhaust Gas Temperature | °F | t_em_k | degF
        Engine Coolant Temp | °F | coolant | degF
        Engine Oil Temp | °F | oil | degF
        Engine Oil Pressure | psi | oil pressure | psi gauge
        Trans Fluid Temp | °F | oil | degF
        Barometric Pressure | psi | p_amb_pa | psi
        Fuel Rail Pressure | psi | rail | psi""", row=True),
    file_of("an inspection station, initials in Chinese", """
        time | s | time_s |
        fdjzs | r/min | n_e_rpm |
        jql | g/s | w_c_kg_s | g/s
        zyyl | kPa | p_im_pa | kPa
        pqwd | °C | t_em_k | degC
        egrkd | % | u_egr_pct | %
        hyl | L/h | fuel | L/h
        cs | km/h | vehicle |
        fhz | % | torque % | %
        ymkd | % | pedal | %""", row=True),
    file_of("an Italian app", """
        tempo | s | time_s |
        Giri motore | rpm | n_e_rpm |
        Velocità | km/h | vehicle |
        Portata aria (MAF) | g/s | w_c_kg_s | g/s
        Pressione collettore aspirazione (MAP) | kPa | p_im_pa | kPa
        Pressione barometrica | kPa | p_amb_pa | kPa
        Apertura EGR comandata | % | u_egr_pct | %
        Temp. aria aspirazione | °C | t_im_k | degC
        Temperatura refrigerante | °C | coolant | degC
        Temperatura olio | °C | oil | degC""", row=True),
)  # fmt: skip

AGAIN: tuple[Foreign, ...] = (
    file_of("a Spanish university's bench", """
        Time | s | time_s |
        DynoSpeed | rpm | n_e_rpm |
        DynoTorque | Nm | torque_nm |
        M_Aire | kg/h | w_c_kg_s | kg/h
        CNS_Combus | kg/h | fuel | kg/h
        EGR | % | egr rate | fraction of 1
        rpm_turbo | rpm | omega_t_rad_s | rpm of rad/s
        P_S_WCAC | bar | p_im_pa | bar
        P_sala | bar | p_amb_pa | bar
        T_sala_1 | °C | t_amb_k | degC
        T_adm_1 | °C | t_im_k | degC
        Opacidad | % | torque % | %""", row=True),
    file_of("identifiers of a diagnosis program", """
        time | s | time_s |
        EGR_POSITION_ACTUAL | % | u_egr_pct | %
        EGR_POSITION_DESIRED | % | egr wanted | %
        EGR_MASS_FLOW | kg/h | w_egr_kg_s | kg/h
        BOOST_PRESSURE_ACTUAL | mbar | p_im_pa | mbar
        BOOST_PRESSURE_DESIRED | mbar | boost wanted | mbar
        VNT_POSITION_ACTUAL | % | u_vgt_pct | %
        VNT_POSITION_DESIRED | % | vgt wanted | %
        AIR_MASS_FLOW | kg/h | w_c_kg_s | kg/h
        ATMOSPHERIC_PRESSURE | mbar | p_amb_pa | mbar
        THROTTLE_POSITION_DIESEL | % | pedal | %""", row=True),
    file_of("a truck display, units in the names", """
        at | s | time_s |
        engineSpeedRpm | | n_e_rpm |
        vehicleSpeedKph | | vehicle |
        throttlePct | | pedal | %
        engineLoadPct | | torque % | %
        coolantTempC | | coolant | degC
        oilTempC | | oil | degC
        oilPressureKpa | | oil pressure | kPa gauge
        fuelRateLph | | fuel | L/h
        fuelRailPressureBar | | rail | bar
        intakeManifoldPressureKpa | | p_im_pa | kPa gauge
        intakeManifoldTempC | | t_im_k | degC
        barometricPressureKpa | | p_amb_pa | kPa
        exhaustTempC | | t_em_k | degC
        turbochargerSpeedRpm | | omega_t_rad_s | rpm of rad/s
        ambientTempC | | t_amb_k | degC
        fuelTempC | | t fuel | degC"""),
    file_of("a simulation of leaks", """
        timestamp | s | time_s |
        RPM | rpm | n_e_rpm |
        MAF | kg/h | w_c_kg_s | kg/h
        MAP_boost | kPa | p_im_pa | kPa
        T_cac_out | °C | t_im_k | degC
        T_exh_manifold | °C | t_em_k | degC
        T_post_turbine | °C | t after | degC
        T_DOC | °C | t after | degC
        fuel_qty | mg/stroke | u_delta_mg |
        turbo_speed | rpm | omega_t_rad_s | rpm of rad/s
        P_exh_manifold | kPa | p_em_pa | kPa
        P_turbine_out | kPa | p after | kPa""", row=True),
    file_of("keys of a Spanish app", """
        timestamp_offset_ms | ms | time_s |
        RPM | 1/min | n_e_rpm |
        SPEED | km/h | vehicle |
        COOLANT_TEMP | °C | coolant | degC
        INTAKE_TEMP | °C | t_im_k | degC
        MAF | g/s | w_c_kg_s | g/s
        VAG_INJECTION_QUANTITY | mg/str | u_delta_mg |
        VAG_BOOST_PRESSURE_REQUESTED | kPa | boost wanted | kPa
        VAG_BOOST_PRESSURE_ACTUAL | kPa | p_im_pa | kPa
        VAG_BAROMETRIC_PRESSURE | kPa | p_amb_pa | kPa
        VAG_EGR_DUTY_CYCLE | % | u_egr_pct | %
        VAG_EXHAUST_TEMP_1 | °C | t_em_k | degC
        VAG_EXHAUST_TEMP_2 | °C | t after | degC
        VAG_AMBIENT_TEMP | °C | t_amb_k | degC
        VAG_FUEL_TEMP | °C | t fuel | degC
        VAG_OIL_TEMP | °C | oil | degC
        VAG_ENGINE_TORQUE | Nm | torque_nm |
        VAG_DRIVER_TORQUE_REQUEST | Nm | torque wanted |
        VAG_RAIL_PRESSURE_ACTUAL | bar | rail | bar
        VAG_ACCELERATOR_POSITION | % | pedal | %""", row=True),
)  # fmt: skip
"""Five more, gathered after what the first fifteen showed was mended."""
